"""Tables of an output folder as the verification reads them."""
