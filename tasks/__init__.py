"""How a row is computed: arrays and records in, arrays and records out. Imports schemas, nothing else of ours."""
