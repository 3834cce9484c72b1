"""The HTTP service: routes, jobs and storage. It contains no science."""
