"""The command line `dynident`.

Modules that take long to import are imported inside the command that needs them, so that `dynident --help` is quick.
"""
