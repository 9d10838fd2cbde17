# `make release` writes it to dist, with the version, the sum and the place of the project: a formula for a tap of one's
# own. Packages come from PyPI as wheels, which formulae in Homebrew's own list may not do. Not built by our CI.
class GsCodec < Formula
  desc "Compresses trained 3D Gaussian Splatting scenes, and measures the loss"
  homepage "@URL@"
  url "https://pypi.org/packages/source/g/gs-codec/gs_codec-@VERSION@.tar.gz"
  sha256 "@SHA256@"
  license "GPL-3.0-or-later"

  depends_on "python@3.13"

  def install
    system Formula["python@3.13"].opt_bin/"python3.13", "-m", "venv", libexec
    system libexec/"bin/pip", "install", buildpath
    bin.install_symlink libexec/"bin/gs-codec", libexec/"bin/gs-viewer"
  end

  test do
    assert_equal "gs-codec #{version}\n", shell_output("#{bin}/gs-codec --version")
  end
end
