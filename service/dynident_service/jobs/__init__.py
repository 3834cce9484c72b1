"""Execution of jobs: the engine that claims them, child processes that run them, Dask workers."""
