"""What each of upwash's mechanisms gains, in the same worlds and beside the same bound."""
