"""Contact tracking: where the finger will be when what is rendered now is put out.

`tracker` follows the samples of one finger, `finger_motion` estimates how it moves, and `clock_map`
converts the time stamps of a client to the clock of the display.
"""
