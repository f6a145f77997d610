"""Standard interfaces: the farm for PettingZoo and Gymnasium, and PettingZoo environments for workers."""
