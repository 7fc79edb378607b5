"""The strongest baselines, in the same worlds: a drone that is flown well alone, and what others have published."""
