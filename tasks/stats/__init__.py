"""Statistics as pictures and a report: Arrow tables and meshes in; SVG, PNG, JPEG and HTML out."""
