"""The search for the best periodic trajectory: random ones, then the best of them improved."""
