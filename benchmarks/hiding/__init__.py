"""Arms with something hidden in them: what, where, how large, whether it shows, whether it was found."""
