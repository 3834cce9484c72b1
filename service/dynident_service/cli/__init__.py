"""The command line. Whatever takes long to import is imported by the command that needs it."""
