"""The command line `dynident`; slow modules are imported inside the commands.

Modules that take long to import are imported inside the command that needs them, so that `dynident --help` is quick.
"""
