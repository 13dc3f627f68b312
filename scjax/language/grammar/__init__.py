"""Captions as people write, composed from hand-written phrasings: ``compose.compose``."""
