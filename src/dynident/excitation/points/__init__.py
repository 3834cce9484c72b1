"""Search for the best sequence of points (§12.3.4.1) that the arm visits, at rest in each."""
