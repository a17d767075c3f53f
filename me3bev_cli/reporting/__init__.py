"""The report: a static page of evaluations and of the runs that they are of."""
