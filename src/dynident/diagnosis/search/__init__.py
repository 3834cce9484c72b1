"""The search for what is missing: candidates are added, refined, and taken out again where superfluous."""
