"""The virtual multi-axial benchmark problem of real-time hybrid simulation (docs/rths.md).

J. W. Condori Uribe and others, Front. Built Environ. 9, 1270996 (2023); the block diagram is that
of M. Quiroz, C. Galmez, G. A. Fermandois, ibid. 10, 1394952 (2024).
"""
