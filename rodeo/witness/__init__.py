"""What devices sign about what they saw, as links of one chain each that hold each other in order.

`Witness` is a device on the bus, `WitnessChain` signs, `Journal` remembers, `HeadBook` collects what others
signed; `parse` reads a statement, `track` the motion that motion capture signed. What a statement counts for
is in `rodeo.checks.signed`.
"""
