"""Studies of a design: sweeps, criteria, fits to measurements and optimization.

A study starts from a question ("how long should the bender be, for which finger?"). Its axes are
`parameters`, each a number or a name with its unit; every combination is solved over frequency
(`tactile.actuator.response`) and judged by `criteria`, and what is found is a labeled array
(xarray) that carries its units and how it came to be (`sweep`). `ranges` reads from it what is
within some percent of the best and where several fingers agree. `load_fit` and `admittance_fit`
find the finger and the bimorph that a `measurement` was made of.
"""
