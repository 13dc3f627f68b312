"""Motion for the training of behaviors: logs -> tokens on routes, with what each agent saw."""
