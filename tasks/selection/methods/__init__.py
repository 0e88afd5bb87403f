"""The methods by which candidates are scored; one is chosen with `selection.provider`.

`members` has their objects. What several of them use lies beside them: pictures of assets, foreign encoders, an endpoint.
"""
