"""Contact tracking: prediction of the finger's position at the time when a block is put out.

`tracker` follows the samples of one finger, each a `FingerSample`, `finger_motion` estimates its
motion, and `clock_map` converts the time stamps of a client to the clock of the display.
"""
