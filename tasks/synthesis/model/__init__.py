"""Learned micro-scene synthesis (supplementary B.2): ATISS, DiffuScene and PhyScene without floor plan, on one encoding of layouts.

Modules below `networks` are torch code and are imported as torch is: inside of the function that needs them.
"""
