"""What a farm's conditions do, and what UAVs see of them: a file for each."""
