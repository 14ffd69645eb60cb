"""Studies: jobs that an experiment file asks for, from a tissue to a run folder's files."""
