"""The commands, alone or with their relatives: their options, and what they do with them."""
