"""The pool: jobs are done by the workers of a dask cluster. Only this package imports dask.

authority   the pool's own certificates
serving     a scheduler and workers, until they are asked to stop
work        what a worker does with a question: it asks its helper
helper      does jobs in children with limits, as the engine of this machine does
engine      gives jobs to a pool, and believes of the answers what `Work.check` finds in them

What a job is stands in `rodeo.jobs`. Nothing here has keys, and no service can import it.
"""
