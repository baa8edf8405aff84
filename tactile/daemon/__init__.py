"""Playing: the loop that brings renderer and bus together."""
