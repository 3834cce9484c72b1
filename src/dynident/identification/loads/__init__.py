"""What runs with a known load tell: of drive gains, of loads, of a robot whose gains nobody knows."""
