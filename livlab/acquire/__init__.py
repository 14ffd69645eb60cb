"""Instruments, virtual and real."""
