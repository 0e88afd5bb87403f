"""Networks of others that see, in this process: where they run, whose weights they have, and pictures as they take them."""
