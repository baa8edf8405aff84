"""Driver and texture renderer for tactile displays made of piezoelectric bimorph arrays."""
