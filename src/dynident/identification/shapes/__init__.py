"""Constants inside an effect's columns: searched, brought to the smallest error, and how sure they are."""
