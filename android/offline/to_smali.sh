#!/bin/sh
# Turns the Java of the app into the smali that offline/build.py assembles: to be run, and its result committed, whenever the Java changes
# (tests/test_android.py tells). Needs javac and baksmali (Debian's libsmali-java), and two jars that Debian 12 no longer has:
#   to_smali.sh ANDROID_JAR DX_JAR      (libandroid-23-java and dalvik-exchange of Debian 11)
set -eu
android=$1 dx=$2 here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
sources=$(cd "$here/../app/src/main/java" && find . -name '*.java' | LC_ALL=C sort)
(cd "$here/../app/src/main/java" && javac --release 8 -Xlint:-options -g:none -cp "$android" -d "$work/classes" $sources)
java -cp "$dx" com.android.dx.command.Main --dex --min-sdk-version=26 --output="$work/classes.dex" "$work/classes"
rm -rf "$here/smali"
java -jar /usr/share/java/baksmali.jar disassemble --api 29 --output "$here/smali" "$work/classes.dex"
(cd "$here/../app/src/main/java" && sha256sum $sources) > "$here/smali/SOURCES"
