"""Studies of a design: sweeps, criteria, fits to measurements and optimization.

A study starts from a question ("how long should the bender be, for which finger?"). Its axes are
parameters (`parameters`), each a number or a name with its unit. Every combination of their values
is solved over frequency (`tactile.actuator.response`) and judged by `criteria`. The result is a
labeled array (xarray) that carries its units and its provenance (`sweep`). `ranges` reads from it
which values are within some percent of the best, and where several fingers agree. `load_fit` and
`admittance_fit` find the finger load and the bimorph behind a `measurement`.
"""
