"""Parameters of a model: the bodies that they belong to, standard parameters, and judgements of estimates."""
