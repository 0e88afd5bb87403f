"""How good drawn layouts are (specs D.6): categories, collisions, support, variety, likeness to the truth and to what was learned from.

Pure functions of layouts; every draw is seeded. Names and figures:

- `distributions`: shares of categories, `category_kl` (CKL), `total_variation`;
- `boxes`: boxes that go into each other, that reach over the edge, that stand on nothing;
- `distances`: how far layouts are from each other, variety, distance to the nearest layout that was learned from;
- `discrimination`: how well a classifier tells drawn layouts from true ones (SCA);
- `renders`: KID and FID of pictures from above, with a feature network as a parameter.
"""
