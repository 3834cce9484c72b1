"""The HTTP service and the workbench; contains no science."""
