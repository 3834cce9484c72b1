"""Between the contract and the science: requests become dataclasses, results become JSON."""
