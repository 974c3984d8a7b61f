"""Fuzzy systems, in this order: declared readably, proven without holes, compiled for the control loop.

`membership`, `variable`, `rulebase`: the declaration. `coverage`: the proof. `bases`: the rule bases of the
laws. `kernel`, `compiled`: what the loop runs. `oracle`: scikit-fuzzy, which that is judged by.
"""
