"""The desk: robots, recordings, models and findings as one works with them in a notebook.

`import dynident` gives everything here by name, and loads it when it is used.
"""
