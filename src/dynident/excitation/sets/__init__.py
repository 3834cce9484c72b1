"""Sets of special test motions (§12.3.4.2), run one after the other."""
