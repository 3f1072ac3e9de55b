"""Moving joints of a cell: the arm's chain, external joints and mimic joints."""
