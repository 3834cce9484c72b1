"""Validations of models."""
