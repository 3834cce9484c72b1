"""The HTTP service: routes, jobs, storage. It holds no science."""
