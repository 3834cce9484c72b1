"""What the robot must not touch, itself included: what is stated, how near a motion comes, and its gradient."""
