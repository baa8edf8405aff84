"""The bimorph, the finger that loads it, and what the two do together.

From materials and geometry to shear per volt, in the frequency domain (`response`) and in time
(`plant`). The model is that of Hofmann & Twiefel, "Optimization of a Piezoelectric Bending
Actuator for a Tactile Virtual Reality Display", Energy Harvesting and Systems 2014,
doi 10.1515/ehs-2014-0055, with the misprints of its equations corrected.
"""
