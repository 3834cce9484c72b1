"""Collision checks with the surroundings and the robot itself: what is stated, how near a motion comes, gradients."""
