"""Questions about a design, and answers: figures of a bimorph, sweeps, fits to measurements."""
