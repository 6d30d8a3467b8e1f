"""The keys of other machines: who is authorised, and the directory that keeps them."""
