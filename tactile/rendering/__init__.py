"""From a surface and a moving finger to volts: contact, shear, equalizer, limiter, renderer."""
