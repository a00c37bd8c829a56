"""Dishonest proofs, from crude to careful, made from honest recordings: each kind's harness names its own,
with the role that makes it and the check that has to refuse it. Most are sealed with the executor's key.
`composed` puts more together from primitives, by a seed.
"""
