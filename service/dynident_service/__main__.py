"""`python -m dynident_service` starts the service with the settings of the environment."""

from dynident_service.serve import serve

if __name__ == "__main__":
    serve()
