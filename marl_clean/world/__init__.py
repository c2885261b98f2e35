"""The physics of the cleaning world: pure tensor functions over one typed state.

Reading order, ten minutes: `rules` (what is fixed), `state` (what changes), `setup` (what begins
and stays), `step` (a step and a beginning), `dynamics` (moves), `rewards` (what they pay),
`shared_map` (what the robots remember), `sensing` (what they see), `furniture`, `distance`,
`potential` and `random`.
"""
