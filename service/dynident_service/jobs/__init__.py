"""Jobs: a ledger in the database says what is to be done, the engine hands it out, a child process does it."""
