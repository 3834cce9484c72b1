"""Where the service keeps things: a database for what is small, an object store for what is large."""
