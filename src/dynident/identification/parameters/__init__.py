"""What the parameters of a model are: of which body, as standard parameters, and what is to be held of them."""
