"""Search for the best periodic trajectory: random candidates, then improvement of the best of them."""
