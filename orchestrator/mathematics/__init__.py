"""Mathematics: arrays in, arrays out; of perfbound it imports `schemas.values` alone."""
