"""The policies: which server to select, and whether a call waits, runs remotely or locally.

Laws:
- a policy is a value: it remembers nothing, contacts nobody, and answers from what it is shown;
- only a policy with a `horizon` is shown a forecast;
- a decision carries its inputs, which the log has whole.

    policy       the questions, the answers, and three policies of the thesis
    look_ahead   the default policy, which plans the calls to come
    names        policies by their names in a configuration
"""
