"""The classes and functions that `import dynident` gives by name: robots, recordings, models, findings.

They add to the packages below what work in a notebook needs: tables, data frames, drawings, saving.
"""
