"""Request fields with their description, and registries of classes that a request can name."""
