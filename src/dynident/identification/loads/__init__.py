"""Known loads: drive gains from runs with a known payload, payload masses, and models in units of current."""
