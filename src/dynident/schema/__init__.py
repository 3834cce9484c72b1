"""Fields of requests, described once, and registries of what a request may name."""
