"""Work that can be done anywhere and kept: jobs, their store and their schedulers."""
