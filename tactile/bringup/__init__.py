"""Bring-up: the first time that a display is driven, line by line."""
