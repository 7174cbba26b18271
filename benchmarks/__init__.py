"""What slicemask costs, next to its peers on the same work in the same run.

``python -m benchmarks`` prints every table; ``python -m benchmarks --help`` says how to run one.
"""
