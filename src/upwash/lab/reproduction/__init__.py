"""The evaluation of the thesis, flown again: its table, its figures, and what differs.

- `cells.py` has the experiments. There is one parameter set for each set-up, and only the mode, the policy and the
  load on s2 differ from it.
- `quantities.py` computes the thesis's figures from missions, and has what it prints, with its contradictions.
- `sensitivity.py` varies one parameter at a time. `output.py` prints, writes and draws.
"""
