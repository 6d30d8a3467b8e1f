"""The keys of other machines: the list of authorised keys and the directory that stores them."""
