"""The commands of `dynident`, a module for one or a few: their options and what they do."""
