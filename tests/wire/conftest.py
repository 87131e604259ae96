from hypothesis import settings

settings.register_profile("wire", max_examples=100)
settings.load_profile("wire")
