"""Known loads: drive gains and payload masses from runs with a payload; models in units of current."""
