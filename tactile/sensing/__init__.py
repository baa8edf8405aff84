"""Sensing: the load of the finger on each contactor, from the current that the bender draws.

A bender is its own sensor. With the force F of a held tip per volt, the dynamic stiffness S of the
tip and the dynamic stiffness k = jωZ_L of the load,

    q/U = C + F²/(S + k),    u/U = F/(S + k),    1/H = S/F + k/F,

so that charge q and shear u depend on the same load. The second term of the charge is a few percent
of the first, which therefore is measured in air before (`baseline`). `estimator` follows the load
of each contactor from the current while textures play, and `inverse_mix` makes the equalizer's
filter from it. Everything here takes arrays and returns arrays; only the estimator has a state.
"""
