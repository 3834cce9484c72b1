"""Jobs: a queue in the database, an engine that hands jobs out, and child processes that do them."""
