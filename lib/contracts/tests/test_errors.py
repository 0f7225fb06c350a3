import errno

from inpaint3d.contracts import errors


def test_every_branch_has_its_own_exit_code():
    branches = [b for b in errors.Inpaint3dError.__subclasses__() if b is not errors.NonFiniteError]
    codes = [b.exit_code for b in branches]
    assert len(set(codes)) == len(codes)
    assert set(errors.EXIT_CODES) == {1, *codes}


def test_the_drawing_in_the_docstring_is_the_tree():
    for name, error in vars(errors).items():
        if isinstance(error, type) and issubclass(error, errors.Inpaint3dError):
            line = next(line for line in errors.__doc__.splitlines() if f"{name} " in line + " ")
            if error is not errors.ArtifactError:
                assert f" {error.exit_code} " in line


def test_a_copy_without_room_names_the_file_that_did_not_fit():
    full = OSError(errno.ENOSPC, "No space left on device", "photo.jpg", None, "store/photo.jpg")
    assert "no space left writing store/photo.jpg" in str(errors.from_os_error(full))
