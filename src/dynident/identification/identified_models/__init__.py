"""Operations on identified models: identify, extend, remove effects, solve again, predict, store."""
