"""What happens to a service that is unlucky: its processes are killed or stopped, its database goes away."""
