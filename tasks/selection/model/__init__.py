"""The learned selection of assets (supplementary B.1): networks, losses, examples, and inference without torch.

Modules below `networks` are torch code and are imported as torch is: inside of the function that needs them.
"""
