"""The display as a file and as arrays: contactors, channels, amplifier, finger and limits."""
