"""Jobs: a ledger in the database says what is to be done, Dask finds the worker, a child process does it."""
