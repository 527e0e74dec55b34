"""Method `rigorous`: one confidence set for exact values, its band, the certified maximum and the regions."""
