"""Phase functions: closed forms, tables, and what the solvers ask of them."""
