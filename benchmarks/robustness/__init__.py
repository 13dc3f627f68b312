"""Does any damaged input end in a traceback, a hang, too much memory or a wrong result? python -m benchmarks.robustness

``areas`` yield damaged inputs, ``worker`` runs them in a process of its own, ``outcome`` judges how each one ended.
"""
