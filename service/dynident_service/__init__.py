"""The HTTP service, the command line and the workbench; contains no science."""
