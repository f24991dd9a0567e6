"""`m3r check`: what is on this machine for flying by voice and hands."""
