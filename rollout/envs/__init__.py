"""Environments: the contract for workers, the farm for PettingZoo and Gymnasium, and PettingZoo environments."""
