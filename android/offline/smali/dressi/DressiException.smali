.class public final Ldressi/DressiException;
.super Ljava/lang/RuntimeException;


# static fields
.field public static final BUNDLE:I = 0x2

.field public static final DEVICE:I = 0x4

.field public static final INPUT:I = 0x3

.field public static final LOST:I = 0x5

.field public static final MEMORY:I = 0x1


# instance fields
.field public final code:I


# direct methods
.method constructor <init>(ILjava/lang/String;)V
    .registers 3

    invoke-direct {p0, p2}, Ljava/lang/RuntimeException;-><init>(Ljava/lang/String;)V

    iput p1, p0, Ldressi/DressiException;->code:I

    return-void
.end method
