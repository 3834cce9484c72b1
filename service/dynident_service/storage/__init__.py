"""Storage: database, job queue, object store, backups."""
