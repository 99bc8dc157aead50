"""Distributed protocols as whole agents, made with agents.api alone, and the checks that judge them."""
