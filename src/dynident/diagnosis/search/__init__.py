"""The search for missing effects: candidates are added, refined, compared with rivals, and removed if superfluous."""
