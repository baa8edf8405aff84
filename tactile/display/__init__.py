"""Description of a display as a file and as arrays: contactors, channels, amplifier and limits."""
