"""How a call is declared, encoded and addressed."""
