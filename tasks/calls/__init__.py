"""Calls to models behind endpoints: how they are asked, how replies are read, and the ledger that remembers every one of them."""
