"""Five procedural vehicles: measures, bodies, liveries, parts."""
