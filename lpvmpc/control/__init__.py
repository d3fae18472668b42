"""The controllers: the adaptive LPV-MPC and what it is compared with. No simulator."""
