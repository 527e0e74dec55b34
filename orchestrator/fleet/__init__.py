"""The simulation of rollouts: who has which attempt, the network, child processes."""
