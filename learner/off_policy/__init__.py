"""Learning from a replay buffer: EIA-SEC as the paper describes it, MADDPG, MATD3, MASAC, VDN and QMIX."""
