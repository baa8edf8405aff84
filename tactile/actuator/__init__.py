"""Model of a piezoelectric bimorph, of the finger that loads it, and of the two together.

The model leads from materials and geometry to shear displacement per volt, in the frequency domain
(`response`) and in the time domain (`plant`). It is that of Hofmann & Twiefel, "Optimization of a
Piezoelectric Bending Actuator for a Tactile Virtual Reality Display", Energy Harvesting and Systems
2014, doi 10.1515/ehs-2014-0055, with the misprints of its equations corrected.
"""
