"""The benchmark of the warehouse: a generated lake of any size, how long it takes to answer and to change, and what it refuses."""
